"""What the answers of /api/v1 are made of: every field, type and unit.

Answers are plain data; tests/web/test_web_schema.py checks real ones against these types.
"""
