"""A simulated rig: true mechanics, sensors and devices that speak the real protocols. Never imports the agent."""
