"""Page over one project in this machine's own browser. Nobody imports it but its command."""
