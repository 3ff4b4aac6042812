"""Identification: springs, dampers, dry friction and masses from motion alone, before any nominal is known."""
