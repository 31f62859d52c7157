"""Object stores: addresses as paths, objects read by ranges and written whole, credentials of the environment."""
