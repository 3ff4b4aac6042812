"""deltak's agent: estimates the stiffness and damping of a monitored structure and remembers them."""

__version__ = "0.1.0"
