"""Advisory generation (AG of ISO 13374): alarm states, alarms of what is not watched, alarms that ask again.

Alarms of what is forecast (PA of ISO 13374) are among them.
"""
