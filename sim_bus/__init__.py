"""deltak's simulator: true mechanics, sensors, devices that speak the real protocols. Never imports the agent."""
