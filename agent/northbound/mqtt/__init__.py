"""MQTT 5 by paho: one connection, rows as JSON on topics of their own, Home Assistant's discovery."""
