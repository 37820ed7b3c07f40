"""The report of a comparison: one page that needs nothing beside it."""

from .page import report_page as report_page
