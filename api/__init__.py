"""The service's face: HTTP, command line, Python client and page."""
