"""The two studies of the paper, run through the pipeline that monitors rigs, and its figures.

K. Classens et al., *Mechanical Systems and Signal Processing* 224 (2025) 112124: section 5 simulates three masses,
section 6 measures a flexible beam, whose rig is simulated here.
"""
