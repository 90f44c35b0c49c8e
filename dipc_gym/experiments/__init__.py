"""The paper's experiment and its kin: cells of a sweep, what they come to, tables and figures."""
