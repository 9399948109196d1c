"""Test design: what a planned test determines, by Fisher information, before it is run.

``prediction`` has the covariances, ``plans`` a model of each kind of test, ``compare`` the
comparison and the recommendation that ``tcdyn rig design`` prints. Planned campaigns are in
``tcdyn.campaign.planned``. Guarded by ``tests/immersion/test_design_predictions.py``.
"""
