// SPDX-License-Identifier: Apache-2.0
/** Kept answers of a dashboard held against the types that the pages are checked with. */
import answers from './answers.json' with { type: 'json' };

const holds = <T>(answer: T): T => answer;

holds<Api.Index>(answers['/api/v1']);
holds<Api.Columns>(answers['/api/v1/columns']);
holds<Api.Sweep[]>(answers['/api/v1/sweeps'].items);
holds<Api.Sweep>(answers['/api/v1/sweeps/study']);
holds<Api.Entry[]>(answers['/api/v1/algorithms'].items);
holds<Api.Entry>(answers['/api/v1/datasets/hall']);
holds<Api.Runs>(answers['/api/v1/runs?limit=6']);
holds<Api.Run>(answers['/api/v1/runs/run-000']);
holds<Api.Run>(answers['/api/v1/runs/run-005']);
holds<Api.Trajectory>(answers['/api/v1/runs/run-000/trajectory?points=50']);
holds<Api.Usage>(answers['/api/v1/runs/run-002/usage']);
holds<Api.Usage>(answers['/api/v1/runs/run-000/usage']);
holds<Api.Aggregate>(
  answers['/api/v1/analysis/aggregate?by=parameters.nFeatures,algorithm&metrics=ate.rmse'],
);
holds<Api.Points>(
  answers['/api/v1/analysis/points?x=parameters.nFeatures&y=ate.rmse&colour=algorithm&facet=dataset'],
);
holds<Api.Common>(answers['/api/v1/analysis/common?uid=run-000&uid=run-001&uid=run-002']);
holds<Api.Compare>(answers['/api/v1/analysis/compare']);
holds<Api.Importance>(answers['/api/v1/analysis/importance']);
holds<Api.Leaderboard>(answers['/api/v1/analysis/leaderboard']);
holds<Api.Pareto>(answers['/api/v1/analysis/pareto?x=usage.cpu.meanCores&y=ate.rmse']);
holds<Api.Repeatability>(answers['/api/v1/analysis/repeatability']);
holds<Api.Suspects>(answers['/api/v1/analysis/suspects']);
holds<Api.Nodes>(answers['/api/v1/analysis/suspects/nodes']);
holds<Api.Versions>(answers['/api/v1/analysis/versions']);
