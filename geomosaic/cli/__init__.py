"""Command line: flags in, one call of the library, words out."""
