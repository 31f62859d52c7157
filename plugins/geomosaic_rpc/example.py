"""An example for `geomosaic sensors rpc`: a scene with the RPC in a file; beside the image it would be found itself."""

from __future__ import annotations

from geomosaic.sensor.plugin import SensorExample

_ZEROS = ", ".join(["0.0"] * 16)
_ONE = ", ".join(["1.0", *["0.0"] * 19])

EXAMPLE = SensorExample(
    (4000, 3000),
    """\
[sensor]
name = "rpc"
rpc = "scene.RPB"

[dem]
height = 420.0
heights = "ellipsoidal"
""",
    {
        "scene.RPB": f"""\
satId = "XX01";
bandId = "P";
SpecId = "RPC00B";
BEGIN_GROUP = IMAGE
  errBias = 10.0;
  errRand = 0.5;
  lineOffset = 1499.5;
  sampOffset = 1999.5;
  latOffset = 45.6;
  longOffset = 12.3;
  heightOffset = 420.0;
  lineScale = 1500.0;
  sampScale = 2000.0;
  latScale = 0.0125;
  longScale = 0.021;
  heightScale = 500.0;
  lineNumCoef = (0.0, 0.14, -0.99, 0.05, {_ZEROS});
  lineDenCoef = ({_ONE});
  sampNumCoef = (0.0, 1.0, 0.12, 0.03, {_ZEROS});
  sampDenCoef = ({_ONE});
END_GROUP = IMAGE
END;
"""
    },
)
