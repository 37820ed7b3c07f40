"""The report of a comparison: one self-contained page."""

from .page import report_page as report_page
