"""Speed, as ratios against named baselines; ``python -m benchmarks`` runs all."""
