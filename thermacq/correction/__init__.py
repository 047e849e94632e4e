"""Corrected pictures of a run: raw counts are never altered, corrections are applied on reading."""
