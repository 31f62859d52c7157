"""Options: each declared once, with its type, unit, default and limits."""
