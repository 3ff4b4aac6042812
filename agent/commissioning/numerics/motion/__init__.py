"""Identification: springs, dampers, dry friction and masses from motion alone, before nominal is known."""
