"""What the commands of commissioning print: check, identify, compare, excite, baseline, limits, score."""
