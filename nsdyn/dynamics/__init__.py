"""Masses, free motion, and the rows of contacts and joints, of free bodies and of trees."""
