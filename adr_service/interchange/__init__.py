"""Converters to and from files of other tools, one module for each format.

Each needs the library of its format, which `pip install 'adr-service[interchange]'` brings.
"""
