"""Rules of the code that no ready linter knows."""
