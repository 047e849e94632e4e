"""Boards and their corners in pictures: what there is to find, finding it, and which view is missing."""
