"""The report on a mosaic: what was done, with which numbers, for people and for programs."""
