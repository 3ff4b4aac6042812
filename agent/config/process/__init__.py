"""What holds for the agent as a whole, whichever rig's file says it."""
