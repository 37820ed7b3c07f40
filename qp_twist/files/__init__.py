"""Files: atomic writing, and reading of tables from other programs."""

from .table import Problems as Problems
from .table import Table as Table
from .table import columns_named as columns_named
from .table_text import of_file as of_file
from .table_text import own_exceptions as own_exceptions
from .table_text import shortened as shortened
from .table_text import text_lines as text_lines
from .table_units import ANGLES as ANGLES
from .table_units import FEEDS as FEEDS
from .table_units import LENGTHS as LENGTHS
from .table_units import TIMES as TIMES
from .table_units import AngleUnit as AngleUnit
from .table_units import FeedUnit as FeedUnit
from .table_units import LengthUnit as LengthUnit
from .table_units import factor as factor
from .table_units import split_unit as split_unit
from .writing import LARGEST_FILE as LARGEST_FILE
from .writing import check_regular as check_regular
from .writing import file_path as file_path
from .writing import inputs as inputs
from .writing import is_folder as is_folder
from .writing import printable as printable
from .writing import read_bytes as read_bytes
from .writing import read_text as read_text
from .writing import whole_file as whole_file
from .writing import write_atomically as write_atomically
