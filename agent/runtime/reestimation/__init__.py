"""Archives of raw recordings estimated again, rigs beside each other and hour after hour."""
