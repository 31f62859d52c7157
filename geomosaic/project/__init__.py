"""Project files and tables, and the objects they describe."""
