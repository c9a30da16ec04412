"""Tools without mechanics: names given by users, files, tables, processes, and messages of libraries."""
