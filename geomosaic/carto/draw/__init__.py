"""Drawing of sheets with matplotlib: the only package that imports it, and only when a sheet is drawn."""
