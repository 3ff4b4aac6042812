"""Notification: whoever is to know of a step of an alarm gets it, once, whatever fails meanwhile.

routing (which step is for whom) -> the store's outbox, in the step's own transaction -> notifier (a thread a
target) -> senders (command, webhook, mail)
"""
