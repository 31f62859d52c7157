"""Public API: one function per thing that is made or measured, thin over the rooms; `import geomosaic` names them."""
