"""A run of seconds."""

SMOKE = {"task": "arm", "method": "simopt", "preset": "smoke"}
