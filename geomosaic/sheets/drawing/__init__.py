"""Drawing of sheets: the only user of matplotlib."""
