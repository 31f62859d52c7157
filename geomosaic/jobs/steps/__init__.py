"""Steps of a project, one file each."""
