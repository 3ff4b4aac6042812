"""deltak's simulator: true mechanics, sensors, devices that speak real protocols. Never imports the agent."""
