"""Sparkplug B 3.0 over MQTT 5: the edge node is the gateway's database, its devices are the rigs.

wire (protocol buffers) -> payload (metrics) -> metrics (rows as metrics) -> peer (births, data, rebirth,
death)
"""
