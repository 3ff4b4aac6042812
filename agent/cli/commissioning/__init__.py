"""What the commands of commissioning print."""
