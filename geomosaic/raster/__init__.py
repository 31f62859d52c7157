"""The only user of GDAL: reading by windows, writing whole files, vectors."""
