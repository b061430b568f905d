"""Where distortion acts: which elements, between a node and the ground or between two nodes, explain the data.

What the best linear approximation leaves, ``R = Y - S U``, is the motion under a missing force ``f = -S^-1 R``.
An element between nodes i and j pushes them apart with equal and opposite forces, so its part of ``f`` lies along
the incidence vector ``e_i - e_j`` (``e_i`` for the ground) at every line, however the force depends on frequency.
That holds with the *estimated* ``S`` too: what an element adds to ``S`` acts through the same incidence vector.

Per line the noise-corrected covariance of ``f`` is ``A D A^T``, with one column of ``A`` an element and any ``D``,
since the forces of several elements may be correlated. Forces are never formed: ``S^-1`` amplifies noise by
``omega^2 M``. Whitened by the noise covariance ``C`` of the residuals, all is in::

    J = S^H C^-1 S        H = S^H C^-1 (B/(E - n)) C^-1 S        B = P sum_e R_e R_e^H

with the gain of a place b, ``b^T H b / b^T J b``: its force power over what noise would give there, 1 if there is
no force. To take elements out, ``J`` is replaced by its Schur complement, which is ``J`` of the directions that
are left.

That takes the same force for the same input at all driven nodes; with unequal force constants an element between
two nodes looks like two of the triangle that they make with the ground.

Nodes and ground are the vertices of a graph, elements its edges. Edges that close a circle are linearly
dependent, so the data determine the *partition* of the vertices into connected parts, not the edges within a part
of three or more vertices ("closed triangles"). There, the edges are chosen whose forces are least correlated, and
they count as separable only if that choice is clear.
"""

from creak.location.search import locate

__all__ = ["locate"]
