"""Robots with goals: one file each, and the catalogue."""
