"""Models of structures, the effects that they may hold, and their time stepping."""
