"""Why an alarm was raised: its verdict computed again from the samples kept around it, beside what was stored."""
