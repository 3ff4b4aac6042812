"""Tuned numbers of notification: name, value, unit, and why."""

# notifier
PAUSE_S = (1.0, 600.0)  # after a failed attempt, at least and, doubled each time, at most
MESSAGES_AT_ONCE = 100
MESSAGES_QUIET = 1000  # looked at together, and in quiet hours, where a critical one may be behind
IDLE_S = 3600.0  # s after which is looked again where nothing is stored: quiet hours may have ended
STORE_S = 2.0  # until a store that cannot be written is asked again
REMEMBERED = 10_000  # messages, the newest, that are known as delivered while that cannot be stored

# senders
LEAST_SECRET = 6  # letters of a part of a secret address that nobody is told; "https" is none
