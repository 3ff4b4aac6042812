"""CAN as a source of samples: the driver; below it the codec, the interfaces and the logs."""
