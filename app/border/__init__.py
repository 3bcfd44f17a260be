"""The distance buffer border: points around the mobile base, their score, and stored files.

    dbb.py        P_i of Algorithm 1, and the border as selected points of P_i, (3)
    score.py      (9) to (11): the score of a point, and the coefficients of (9)
    nearest.py    p_n of Algorithm 3: the nearest point of the surface or of the selected points
    offset.py     the border as a continuous surface: the exact offset of l_m
    mobile.py     distances of points to l_m
    sampling.py   sampling of P_i by a flood of each sector, in parallel processes; its parameters
    cache.py      files with the link pairs and P_i (clouds) of a robot
    reach.py      reachability maps and the fit of (9)

(12) to (16) are in `app.avoidance.acting_point`.
"""
