"""`python -m geomosaic.cli`."""

from __future__ import annotations

from geomosaic.cli.main import main

main()
