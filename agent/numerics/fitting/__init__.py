"""One window fitted alone, beside the estimates: how late a source is, what is wired wrongly."""
