"""What channels deliver, before a model is fitted: lost, impossible, clipped and resting readings; clocks."""
