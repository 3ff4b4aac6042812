"""The simulated rig: a plant with a wear schedule, played as a device on a real local bus. Never imports agent."""
