"""The only reader of configuration: rig, model and service files, and the environment."""
