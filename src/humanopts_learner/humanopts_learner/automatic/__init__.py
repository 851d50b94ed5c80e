"""
Automatic options, found by the algorithm of Stolle and Precup (2002) with two changes.

An option is created for each kind of event in a bottleneck's cell, such as a passenger getting in
or out in Taxi; theirs has one per bottleneck. Also, 400 tasks are drawn: the usual 20 yield 1 to 8
options in Taxi (seeds 1 to 10), not the nine of Subramanian, Isbell and Thomaz (2011).
"""
