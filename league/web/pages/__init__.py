"""The data of each page, one module for each, made from what the reader reads."""
