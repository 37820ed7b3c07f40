"""Snippets are run by tests/docs/test_docs.py; no doctests are to be looked for here."""

collect_ignore_glob = ["*.py", "snippets/*.py", "gallery/*.py"]
