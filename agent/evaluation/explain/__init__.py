"""Why an alarm was raised: its verdict recomputed from the samples kept around it, beside what was stored."""
