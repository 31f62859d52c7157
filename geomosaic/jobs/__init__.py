"""Steps that know what they depend on; only what is stale runs again."""
