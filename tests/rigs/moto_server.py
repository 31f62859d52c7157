"""S3 server of moto with authentication on, in a process of its own: prints its address and the keys of two users."""

from __future__ import annotations

import json
import os
import sys

# What users may do. Calls that make them go without a key; from then on moto checks keys, signatures and policies.
USERS = {"all": ["s3:*"], "reader": ["s3:Get*", "s3:List*"]}
os.environ["INITIAL_NO_AUTH_ACTION_COUNT"] = str(3 * len(USERS))


def main() -> None:
    import boto3
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    common = {"endpoint_url": f"http://{host}:{port}", "region_name": "us-east-1"}
    first = {"aws_access_key_id": "first", "aws_secret_access_key": "first"}
    iam = boto3.client("iam", **common, **first)
    keys = {}
    for user, actions in USERS.items():
        statement = {"Effect": "Allow", "Action": actions, "Resource": "*"}
        policy = json.dumps({"Version": "2012-10-17", "Statement": [statement]})
        iam.create_user(UserName=user)
        iam.put_user_policy(UserName=user, PolicyName=user, PolicyDocument=policy)
        key = iam.create_access_key(UserName=user)["AccessKey"]
        keys[user] = (key["AccessKeyId"], key["SecretAccessKey"])
    own = dict(zip(("aws_access_key_id", "aws_secret_access_key"), keys["all"], strict=True))
    s3 = boto3.client("s3", **common, **own)
    s3.create_bucket(Bucket="tests")
    print(json.dumps({"endpoint": common["endpoint_url"], "keys": keys}), flush=True)
    for _ in sys.stdin:  # until the tests end; each line asks for the uploads that were begun and not ended
        print(len(s3.list_multipart_uploads(Bucket="tests").get("Uploads", [])), flush=True)
    server.stop()


if __name__ == "__main__":
    main()
