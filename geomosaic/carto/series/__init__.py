"""Sheet series: from a place to the name of its sheet, and from a name to the sheet's edges."""
