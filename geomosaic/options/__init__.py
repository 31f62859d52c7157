"""Options, each declared once: the command line, project files, the library and the docs take them from here."""
