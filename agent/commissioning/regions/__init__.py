"""The region in which parameters may lie, drawn: poles, where condition (3) holds, today's estimate."""
