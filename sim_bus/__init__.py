"""A simulated rig: true mechanics (`rig`), devices that speak the real protocols (`devices`), `virtual_time`.

May import codecs of `drivers`; never imports the agent.
"""
