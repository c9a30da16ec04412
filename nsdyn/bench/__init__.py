"""Speed against error: engines on cases with known answers, solvers on folders of problems."""
