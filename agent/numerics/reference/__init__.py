"""What parameters are like on a healthy machine, and what limits that allows."""
