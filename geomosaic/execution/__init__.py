"""Execution of units of work: threads, other processes, a cluster."""
