"""What parameters are like on a healthy machine, how sure a departure is, and what limits that allows.

Mathematics of rows that are stored, as prognosis is: no clock, no input or output, no configuration.
"""

from agent.numerics import lean_import as lean_import  # before anything imports scipy
