"""S3 server of moto with authentication on, in a process of its own: prints its address and a key that may do all."""

from __future__ import annotations

import json
import os
import sys

# Calls that make the user go without one; from then on moto checks keys, signatures and policies.
os.environ["INITIAL_NO_AUTH_ACTION_COUNT"] = "3"


def main() -> None:
    import boto3
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    common = {"endpoint_url": f"http://{host}:{port}", "region_name": "us-east-1"}
    first = {"aws_access_key_id": "first", "aws_secret_access_key": "first"}
    iam = boto3.client("iam", **common, **first)
    every = json.dumps({"Version": "2012-10-17", "Statement": [{"Effect": "Allow", "Action": "s3:*", "Resource": "*"}]})
    iam.create_user(UserName="all")
    iam.put_user_policy(UserName="all", PolicyName="all", PolicyDocument=every)
    key = iam.create_access_key(UserName="all")["AccessKey"]
    own = {"aws_access_key_id": key["AccessKeyId"], "aws_secret_access_key": key["SecretAccessKey"]}
    s3 = boto3.client("s3", **common, **own)
    s3.create_bucket(Bucket="tests")
    print(
        json.dumps({"endpoint": common["endpoint_url"], "key": key["AccessKeyId"], "secret": key["SecretAccessKey"]}),
        flush=True,
    )
    for _ in sys.stdin:  # until the tests end; each line asks for the uploads that were begun and not ended
        print(len(s3.list_multipart_uploads(Bucket="tests").get("Uploads", [])), flush=True)
    server.stop()


if __name__ == "__main__":
    main()
