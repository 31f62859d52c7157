"""Sheets in the studio: layouts of a project, their form, their preview and their print."""
