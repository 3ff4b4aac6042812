"""Tuned numbers of the command line and the page: name, value, unit, and why."""

# commissioning/compare, identify
LINE_POINTS = 2000  # points of a line: more are a band
DRAWN_SAMPLES = 4000  # samples of a picture: more are a band

# gateway/diag, redaction, status
DIAG_S = 60.0  # s, the newest, that a diagnosis keeps of samples and of frames
DIAG_BYTES = 20_000_000  # of one file of text at most, from its end
SECRET_LETTERS = 4  # letters of a secret that is removed everywhere: shorter ones stand there by chance
RELOAD_WAIT_S = 180.0  # s that a reload is waited for: longer than the agent waits for it

# glance/covariates, frame, state, watch
LATE_MEAN_S = 120.0  # a mean is of a minute that is over, and is committed some time later
BAR_WIDTH = 25  # characters of a bar ...
LEAST_BAR = 11  # ... and of the narrowest one
BAR_LIMITS = 1.25  # how many limits a bar shows to each side
STALE_S = 30.0  # s after which a source is silent: it writes a row of its ledger every 10 s
EVERY_S = 1.0  # s between two looks for what is new

# group
SUMMARY_LETTERS = 120  # characters of a command's first sentence, which the list of commands shows whole

# opcua/conditions, following, server
NORMAL_KEPT = 100  # alarms back to normal that stay, so that whoever acts late learns why it is refused
PAGE_CHANGES = 500  # changes that are read at a time
OPCUA_SESSIONS = 100  # clients at a time
OPCUA_BYTES = 1024 * 1024  # bytes of a message; the library's own bound is a hundred times that

# prognosis/fleet, picture
FLEET_ROWS = 1500  # of one part that are read: evenly spread hours are enough for a slope
MOST_PAST = 100  # forecasts of one parameter that are shown: every second, third ..., and the newest

# tables/queries
TABLE_ROWS = 40  # a table for people shows the newest rows; JSON and CSV give all

# terminal/logs, output
REPEAT_S = 60.0  # s within which a line that comes again is counted, not written
PLAIN_WIDTH = 250  # characters of a line where no terminal says how wide it is

# upgrade/switch
POLL_S = 0.5  # s between two looks whether the new version has begun to estimate
CHECK_S = 600.0  # s that the new version may take to check a configuration
RECENT_S = 60.0  # a rig whose last valid row is older than this, or than the time given, is not waited for

# web/answers, app, documents, forecasts, guard, model, secret, serve, sessions, stream, writes
KEPT_ANSWERS = 64  # answers that are remembered
LONGEST_VALUE = 200  # characters of a value that is asked
ASKED_AT_ONCE = 2  # questions to the databases; others wait
MOST_LISTENERS = 600  # pages that follow at a time
MOST_INSTANTS = 5000  # rows of estimates are given whole, so this is a limit on what one answer holds
PAGE_POINTS = 20_000  # points of a course that may be asked for ...
SHOWN_POINTS = 800  # ... and those that are given where nothing is said: a line on a screen
KEPT_PARTS = 100  # parameters whose past forecasts are remembered
PATIENCE_S = 30.0  # s for whoever does not read an answer; a listener that is slow costs its place
DRAWN_ELEMENTS = 24  # elements that can be drawn: more would be a tangle, of which only the boxes are drawn
PASSWORD_COST = (16384, 8, 1)  # n, r, p: 16 MB and some 50 ms a try
PASSWORD_BYTES = 8  # bytes of the shortest password
SECRET_BYTES = 1024  # bytes of the longest password
TOKEN_BYTES = 16  # bytes of the shortest token
SECRET_FILE_BYTES = 65536  # bytes read of a file that holds one
WEB_STOP_S = 2  # s for answers that are on their way when the page ends
SESSION_S = 12 * 3600.0  # a shift and a half; then one signs in anew
MOST_SESSIONS = 100  # sessions at a time; the oldest ends
FAILURES = 5  # wrong passwords an address may give ...
FAILURES_S = 60.0  # ... within so many seconds
FAILED_HOSTS = 1000  # addresses whose wrong passwords are remembered
MOST_BEHIND = 20_000  # instants that are given one by one to who missed them; of more the page is read anew
RECENT_CHANGES = 2000  # changes kept for those who follow
STREAM_POLL_S = 0.2  # s between two looks for what is new
ALIVE_S = 15.0  # s without news after which a listener is sent a line, so that nobody between hangs up
PAGE_INSTANTS = 200  # instants that are read at a time
COARSE_NS = 100_000_000  # ns after which a later commit surely changes its file's time, which is coarse
REQUEST_BYTES = 16384  # bytes of a request's body
NAME_LETTERS = 64  # characters of the name of whoever asks
