"""Where period frames come from: a simulated rig, a measurement, a recording."""
