"""What the operator does to alarms, and what the alarm system is like to work with."""
