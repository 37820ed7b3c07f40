"""Methods side by side: metrics, table, figures, report."""

from .compare import Comparison as Comparison
from .compare import Interrupted as Interrupted
from .compare import compare as compare
from .metrics import metrics as metrics
from .table import csv_table as csv_table
from .table import notes as notes
from .table import rich_table as rich_table
