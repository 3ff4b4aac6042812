"""The tables that say what becomes of results: kept, forecast, shown, sent."""
