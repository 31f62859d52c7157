"""A project file for what lies in a folder."""
