"""What a running agent says of itself: status, metrics.

Imported by the service alone.
"""
