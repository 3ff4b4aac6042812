"""The numerics of commissioning: no input or output, no clock, no log, no configuration.

What is wired, scaled or delayed wrongly (`wiring`, `channel_constants`), the least that anybody can know from
a window (`information`), the motion that teaches most (`design`, `multisine`), and springs and dampers from
motion alone (`motion`).
"""
