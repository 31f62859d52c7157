"""Points measured in several photos, linearised: sparse normal equations, and the search for wrong measurements."""
