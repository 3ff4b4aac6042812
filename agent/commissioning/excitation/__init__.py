"""Designing the motion that teaches most; deltak writes it down and never transmits it."""
