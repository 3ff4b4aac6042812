"""Forecasts of a database's histories: made on request, by the running agent, in replays; and scored."""
