"""Snippets are run by tests/test_docs.py; doctests of modules are not to be looked for here."""

collect_ignore_glob = ["*.py", "snippets/*.py", "gallery/*.py"]
