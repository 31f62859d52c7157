"""Blunders of measurements: by mean shifts, data snooping, robust estimation, neighbours, and weighed hypotheses."""
