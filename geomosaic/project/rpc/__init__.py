"""RPCs from plain declarations."""
