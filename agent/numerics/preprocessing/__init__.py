"""What channels deliver, before any model is fitted: lost, impossible, clipped and resting readings; clocks."""
