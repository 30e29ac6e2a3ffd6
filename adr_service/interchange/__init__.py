"""Files of other tools, a module each: what they hold is ours, what they look like is theirs.

Each module needs the library of its format, which `pip install 'adr-service[interchange]'` brings.
"""
