"""Ray: where stages run. The only package that imports it."""
