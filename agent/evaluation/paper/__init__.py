"""The paper's tables and figures, computed anew."""
