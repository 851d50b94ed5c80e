"""
Options found without a person, by the algorithm of Stolle and Precup (2002), changed in two ways.

An option is made for each kind of event in a bottleneck's cell, as in Taxi the passenger gets in
or out; theirs has one for each bottleneck. And 400 tasks are drawn; with the usual 20 there are 1
to 8 options in Taxi (seeds 1 to 10), not the nine of Subramanian, Isbell and Thomaz (2011).
"""
