"""What the paper reports, to be printed beside our results."""

# Table 1: e_rel(u), e_rel(u1), e_rel(u2) in percent.
TABLE = {
    "1": (19.22, 28.07, 10.10),
    "2": (31.69, 35.94, 28.64),
    "3": (20.92, 23.77, 18.87),
    "4": (10.21, 12.08, 8.81),
    "5": (6.48, 7.70, 5.56),
}

# Largest errors of u1 and u2 in px, from the text; only tests 1 and 5 are quoted.
LARGEST = {"1": (2.6, 0.6), "5": (0.6, 0.35)}
