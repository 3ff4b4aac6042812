"""Methods of estimation side by side on one recording."""
