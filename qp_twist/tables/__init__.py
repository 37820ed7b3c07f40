"""Tables that other programs wrote: encodings, dialects, headers with units, rows, problems."""

from .table import Problems as Problems
from .table import Table as Table
from .table import columns_named as columns_named
from .text import of_file as of_file
from .text import text_lines as text_lines
from .units import ANGLES as ANGLES
from .units import FEEDS as FEEDS
from .units import LENGTHS as LENGTHS
from .units import TIMES as TIMES
from .units import AngleUnit as AngleUnit
from .units import FeedUnit as FeedUnit
from .units import LengthUnit as LengthUnit
from .units import factor as factor
from .units import split_unit as split_unit
