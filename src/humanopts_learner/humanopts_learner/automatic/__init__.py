"""
Automatic options, found by the algorithm of Stolle and Precup (2002) with two changes.

An option is created for each kind of event in a bottleneck's cell, instead of one per bottleneck.
Also, 400 tasks are drawn: with the usual 20, fewer options are found than by Subramanian, Isbell
and Thomaz (2011).
"""
