"""Damaged files: salvage, page carving, an estimate of what was lost."""
