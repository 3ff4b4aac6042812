"""The simulated rig: plant, excitation, sensors, wear, faults, scenarios. No bus."""
