"""Forecasts of a database's histories: made for whoever asks, by the agent while it runs, in replays; and scored."""
