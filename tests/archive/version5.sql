BEGIN TRANSACTION;
CREATE TABLE algorithms (
	name VARCHAR(253) NOT NULL, 
	content_hash VARCHAR(64) NOT NULL, 
	labels JSON NOT NULL, 
	attributes JSON NOT NULL, 
	spec JSON NOT NULL, 
	stored DATETIME NOT NULL, 
	PRIMARY KEY (name, content_hash)
);
INSERT INTO "algorithms" VALUES('kiss-icp','c8f19b8727ae6ab080299e9b12f8f8ee4cbf75c3115619bdf13b6bad0d3abceb','{"slamhive.io/family":"lidar-odometry"}','{}','{"description":"Point-to-point ICP odometry with an adaptive threshold; no loop closure","homepage":"https://github.com/PRBonn/kiss-icp","license":"MIT","version":"1.3.0","image":"slamhive/kiss-icp:1.3.0","command":["python3","/opt/slamhive/adapter.py"],"local":{"adapter":"adapter.py","requirements":"requirements.txt","python":">=3.11,<3.14","machines":["x86_64","aarch64"],"systemPackages":[],"libraries":[]},"modes":[{"name":"lidar","roles":["lidar"],"output":null}],"recording":["Rosbag1","Rosbag2","Mcap"],"parameters":{"maxRange":{"type":"Number","default":100,"nullable":false,"minimum":1.0,"maximum":1000.0,"values":null,"unit":"m","description":"Points farther away are ignored"},"minRange":{"type":"Number","default":0,"nullable":false,"minimum":0.0,"maximum":100.0,"values":null,"unit":"m","description":"Points closer are ignored"},"deskew":{"type":"Boolean","default":true,"nullable":false,"minimum":null,"maximum":null,"values":null,"unit":null,"description":"Undo the motion within a scan"},"voxelSize":{"type":"Number","default":null,"nullable":true,"minimum":0.01,"maximum":20.0,"values":null,"unit":"m","description":"Size of the map''s voxels; null makes it a hundredth of maxRange"},"maxPointsPerVoxel":{"type":"Integer","default":20,"nullable":false,"minimum":1.0,"maximum":1000.0,"values":null,"unit":null,"description":"Points kept in a voxel of the map"},"maxIterations":{"type":"Integer","default":500,"nullable":false,"minimum":1.0,"maximum":10000.0,"values":null,"unit":null,"description":"Iterations of ICP at most"},"convergenceCriterion":{"type":"Number","default":0.0001,"nullable":false,"minimum":1e-09,"maximum":1.0,"values":null,"unit":null,"description":"ICP ends when a step is smaller than this"},"fixedThreshold":{"type":"Number","default":null,"nullable":true,"minimum":0.001,"maximum":100.0,"values":null,"unit":"m","description":"A fixed threshold of correspondence; null adapts it"},"initialThreshold":{"type":"Number","default":2,"nullable":false,"minimum":0.001,"maximum":100.0,"values":null,"unit":"m","description":"Where the adaptive threshold starts"},"minMotionThreshold":{"type":"Number","default":0.1,"nullable":false,"minimum":0.001,"maximum":10.0,"values":null,"unit":"m","description":"Least motion that the adaptive threshold learns from"}},"assets":[],"output":{"frame":"lidar","stamp":"ScanEnd","poses":"Frames","gravityAligned":false,"scale":true},"paces":["Lockstep"],"realtime":null,"ros1":null,"deterministic":"Yes","seed":"Ignored","includesReader":false}','2026-11-22 11:14:09.736910');
CREATE TABLE datasets (
	name VARCHAR(253) NOT NULL, 
	content_hash VARCHAR(64) NOT NULL, 
	labels JSON NOT NULL, 
	attributes JSON NOT NULL, 
	spec JSON NOT NULL, 
	stored DATETIME NOT NULL, 
	PRIMARY KEY (name, content_hash)
);
INSERT INTO "datasets" VALUES('synthetic-lidar','4d5d18643b16219006e5ead390e68e6434631684e0e1fed2b383d388eea9895e','{"slamhive.io/source":"synthetic","slamhive.io/sensors":"lidar"}','{"loops":1,"speed":1.263,"motion":1,"light":1,"noise":1}','{"description":"One lap of 30 m through a generated hall with a spinning LiDAR and an IMU","homepage":null,"license":"Apache-2.0","recording":{"format":"Rosbag1","files":[],"synthetic":{"seed":11,"sensors":["Lidar","Imu"],"loops":1.0,"speed":null,"durationSeconds":30.0,"motion":1.0,"light":1.0,"noise":1.0,"lidar":{"rings":32,"columns":720,"rate":10.0,"minRange":0.5,"maxRange":60.0},"imu":{"rate":200.0},"camera":{"width":480,"height":360,"rate":15.0,"scale":1.0,"exposureSeconds":0.0},"headerOffsetSeconds":0.0,"depthOffsetSeconds":0.0}},"sensors":{},"groundTruth":null,"gravityAligned":true,"attributes":{"loops":1,"speed":1.263,"motion":1,"light":1,"noise":1}}','2026-11-22 11:14:09.743127');
CREATE TABLE results (
	run_id INTEGER NOT NULL, 
	evaluation VARCHAR(253) NOT NULL, 
	outcome VARCHAR(32) NOT NULL, 
	coverage FLOAT, 
	alignment VARCHAR(32), 
	scale FLOAT, 
	ate_rmse FLOAT, 
	rpe_rmse FLOAT, 
	"values" JSON NOT NULL, 
	PRIMARY KEY (run_id, evaluation), 
	FOREIGN KEY(run_id) REFERENCES runs (id) ON DELETE CASCADE
);
INSERT INTO "results" VALUES(1,'se3','Tracked',1.0,'se3',NULL,0.1,NULL,'[190403080480,0.1]');
INSERT INTO "results" VALUES(2,'se3','Tracked',1.0,'se3',NULL,0.1,NULL,'[190403080480,0.1]');
INSERT INTO "results" VALUES(3,'se3','Tracked',1.0,'se3',NULL,0.1,NULL,'[190403080480,0.1]');
INSERT INTO "results" VALUES(5,'se3','Tracked',1.0,'se3',NULL,0.1,NULL,'[190403080480,0.1]');
INSERT INTO "results" VALUES(6,'se3','Tracked',1.0,'se3',NULL,0.1,NULL,'[190403080480,0.1]');
CREATE TABLE runs (
	id INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT, 
	uid VARCHAR(253) NOT NULL, 
	name VARCHAR(253) NOT NULL, 
	sweep VARCHAR(253), 
	point INTEGER, 
	algorithm VARCHAR(253), 
	dataset VARCHAR(253), 
	sensors VARCHAR(32), 
	pace VARCHAR(32), 
	repetition INTEGER, 
	seed BIGINT, 
	phase VARCHAR(32) NOT NULL, 
	reason VARCHAR(64), 
	message TEXT, 
	attempts INTEGER NOT NULL, 
	created DATETIME, 
	started DATETIME, 
	finished DATETIME, 
	content_hash VARCHAR(64), 
	reused_from VARCHAR(253), 
	cpu_model TEXT, 
	cpu_mean_cores FLOAT, 
	cpu_max_cores FLOAT, 
	cpu_seconds FLOAT, 
	memory_peak_bytes BIGINT, 
	wall_seconds FLOAT, 
	algorithm_hash VARCHAR(64), 
	dataset_hash VARCHAR(64), 
	labels JSON NOT NULL, 
	spec JSON NOT NULL, 
	attributes JSON NOT NULL, 
	usage JSON, 
	frames JSON, 
	metrics JSON NOT NULL, 
	trajectory JSON, 
	provenance JSON NOT NULL, 
	folder TEXT, 
	log_tail TEXT, sweep_uid VARCHAR(253), namespace VARCHAR(253), cluster VARCHAR(253), evaluations JSON NOT NULL DEFAULT '[]', note TEXT, tags TEXT, noted DATETIME, 
	UNIQUE (uid)
);
INSERT INTO "runs" VALUES(1,'ffffeeeeddddcccc-0','study-a','study',0,'kiss-icp','synthetic-lidar','lidar','Lockstep',0,0,'Succeeded',NULL,NULL,1,'2026-01-01 12:00:00.000000',NULL,'2026-01-01 12:00:00.000000','c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0',NULL,'cpu',0.5,NULL,2.0,1000,4.0,'c8f19b8727ae6ab080299e9b12f8f8ee4cbf75c3115619bdf13b6bad0d3abceb','4d5d18643b16219006e5ead390e68e6434631684e0e1fed2b383d388eea9895e','{}','[391871329897,40,0,0]','{}','[639134638812,0.5,2.0,1000,4.0]',NULL,'{}','[1001657502827,10,9.0,"c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0"]','[984279491253,"c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0c0","5555555555555555555555555555555555555555555555555555555555555555"]',NULL,NULL,'ffffeeeeddddccccbbbbaaaa99998888',NULL,NULL,'[948066123417]','seen','paper','2026-11-28 00:00:00.000000');
INSERT INTO "runs" VALUES(2,'1a2b3c4d5e6f7081-0@c1c1c1c1','study-b','study',0,'kiss-icp','synthetic-lidar','lidar','Lockstep',0,0,'Succeeded',NULL,NULL,1,'2026-01-01 12:05:00.000000',NULL,'2026-01-01 12:05:00.000000','c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1',NULL,'cpu',0.5,NULL,2.0,1000,4.0,'c8f19b8727ae6ab080299e9b12f8f8ee4cbf75c3115619bdf13b6bad0d3abceb','4d5d18643b16219006e5ead390e68e6434631684e0e1fed2b383d388eea9895e','{}','[391871329897,40,0,0]','{}','[639134638812,0.5,2.0,1000,4.0]',NULL,'{}','[1001657502827,10,9.0,"c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1"]','[984279491253,"c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1c1","5555555555555555555555555555555555555555555555555555555555555555"]',NULL,NULL,'1a2b3c4d5e6f70819a2b3c4d5e6f7081',NULL,NULL,'[948066123417]',NULL,NULL,NULL);
INSERT INTO "runs" VALUES(3,'1a2b3c4d5e6f7081-0','study-b','study',0,'kiss-icp','synthetic-lidar','lidar','Lockstep',0,0,'Succeeded',NULL,NULL,1,'2026-01-01 12:06:00.000000',NULL,'2026-01-01 12:06:00.000000','c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2',NULL,'cpu',0.5,NULL,2.0,1000,4.0,'c8f19b8727ae6ab080299e9b12f8f8ee4cbf75c3115619bdf13b6bad0d3abceb','4d5d18643b16219006e5ead390e68e6434631684e0e1fed2b383d388eea9895e','{}','[391871329897,40,0,0]','{}','[639134638812,0.5,2.0,1000,4.0]',NULL,'{}','[1001657502827,10,9.0,"c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2"]','[984279491253,"c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2c2","5555555555555555555555555555555555555555555555555555555555555555"]',NULL,NULL,'1a2b3c4d5e6f70819a2b3c4d5e6f7081',NULL,NULL,'[948066123417]',NULL,NULL,NULL);
INSERT INTO "runs" VALUES(4,'1a2b3c4d5e6f7081-1','study-c','study',1,'kiss-icp','synthetic-lidar','lidar','Lockstep',1,1,'Failed','AlgorithmFailed',NULL,1,'2026-01-01 12:07:00.000000',NULL,'2026-01-01 12:07:00.000000','c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3',NULL,'cpu',NULL,NULL,NULL,NULL,NULL,'c8f19b8727ae6ab080299e9b12f8f8ee4cbf75c3115619bdf13b6bad0d3abceb','4d5d18643b16219006e5ead390e68e6434631684e0e1fed2b383d388eea9895e','{}','[391871329897,40,1,1]','{}',NULL,NULL,'{}',NULL,'[984279491253,"c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3c3","5555555555555555555555555555555555555555555555555555555555555555"]',NULL,NULL,'1a2b3c4d5e6f70819a2b3c4d5e6f7081',NULL,NULL,'[948066123417]',NULL,NULL,NULL);
INSERT INTO "runs" VALUES(5,'99992c3d-0000-4000-8000-000000000000','study-k','study',0,'kiss-icp','synthetic-lidar','lidar','Lockstep',0,0,'Succeeded',NULL,NULL,1,'2026-01-01 12:03:00.000000',NULL,'2026-01-01 12:03:00.000000','c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4',NULL,'cpu',0.5,NULL,2.0,1000,4.0,'c8f19b8727ae6ab080299e9b12f8f8ee4cbf75c3115619bdf13b6bad0d3abceb','4d5d18643b16219006e5ead390e68e6434631684e0e1fed2b383d388eea9895e','{}','[391871329897,40,0,0]','{}','[639134638812,0.5,2.0,1000,4.0]',NULL,'{}','[1001657502827,10,9.0,"c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4"]','[984279491253,"c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4c4","5555555555555555555555555555555555555555555555555555555555555555"]',NULL,NULL,'0a1b2c3d-0000-4000-8000-000000000000',NULL,NULL,'[948066123417]',NULL,NULL,NULL);
INSERT INTO "runs" VALUES(6,'slam-hive-abc','1','slam-hive',NULL,'kiss-icp','synthetic-lidar','lidar','Lockstep',NULL,NULL,'Succeeded',NULL,NULL,1,NULL,NULL,NULL,NULL,NULL,NULL,0.5,NULL,2.0,1000,4.0,NULL,NULL,'{"run":"1"}','[577941077190,40]','{}','[639134638812,0.5,2.0,1000,4.0]',NULL,'{}','[1001657502827,10,9.0,"c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5"]','{}',NULL,NULL,NULL,NULL,NULL,'[]',NULL,NULL,NULL);
CREATE TABLE shapes (
	number BIGINT NOT NULL, 
	kind VARCHAR(32) NOT NULL, 
	text TEXT NOT NULL, 
	PRIMARY KEY (number)
);
INSERT INTO "shapes" VALUES(190403080480,'values','{"alignment":"se3","settings":"0123","ate":{"rmse":0}}');
INSERT INTO "shapes" VALUES(391871329897,'spec','{"algorithmRef":{"name":"kiss-icp"},"datasetRef":{"name":"synthetic-lidar"},"sensors":"lidar","parameters":{"maxRange":0},"input":{"pace":"Lockstep"},"repetition":0,"seed":0,"evaluate":true}');
INSERT INTO "shapes" VALUES(577941077190,'spec','{"algorithmRef":{"name":"kiss-icp"},"datasetRef":{"name":"synthetic-lidar"},"sensors":"lidar","parameters":{"maxRange":0},"input":{"pace":"Lockstep"},"repetition":null,"seed":null,"evaluate":true}');
INSERT INTO "shapes" VALUES(639134638812,'usage','{"cpu":{"meanCores":0,"seconds":0},"memory":{"peakBytes":0},"wallSeconds":0}');
INSERT INTO "shapes" VALUES(948066123417,'evaluations','[{"evaluation":"se3","alignment":"se3","settings":"2b7ef000cace6ee8"}]');
INSERT INTO "shapes" VALUES(984279491253,'provenance','{"algorithmHash":"701fe6d1aa0b39e8f8ed6f6f93fd8cde9a15b961511199eadc87750f59afacbe","contentHash":0,"specHash":0,"environment":"eeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeeee","datasetSha256":"dddddddddddddddddddddddddddddddddddddddddddddddddddddddddddddddd","cpuModel":"cpu"}');
INSERT INTO "shapes" VALUES(1001657502827,'trajectory','{"poses":0,"durationSeconds":0,"sha256":0,"path":"t"}');
CREATE TABLE slamhive_schema (
	version INTEGER NOT NULL
, identity VARCHAR(36), divided_to BIGINT);
INSERT INTO "slamhive_schema" VALUES(5,'73291938-d015-4c78-acb9-9f9292b619aa',NULL);
CREATE TABLE sweeps (
	uid VARCHAR(253) NOT NULL, 
	name VARCHAR(253) NOT NULL, 
	labels JSON NOT NULL, 
	spec JSON NOT NULL, 
	evaluation JSON, 
	created DATETIME, namespace VARCHAR(253), cluster VARCHAR(253), 
	PRIMARY KEY (uid)
);
INSERT INTO "sweeps" VALUES('ffffeeeeddddccccbbbbaaaa99998888','study','{}','{}','{"alignment":"Auto","frame":"Estimate","association":{"maxDifference":"10ms","offset":0.0},"rpe":[{"delta":1.0,"unit":"m","pairs":"All","relTolerance":0.1}],"success":{"minCoverage":0.9}}','2026-01-01 12:00:00.000000',NULL,NULL);
INSERT INTO "sweeps" VALUES('1a2b3c4d5e6f70819a2b3c4d5e6f7081','study','{}','{}','{"alignment":"Auto","frame":"Estimate","association":{"maxDifference":"10ms","offset":0.0},"rpe":[{"delta":1.0,"unit":"m","pairs":"All","relTolerance":0.1}],"success":{"minCoverage":0.9}}','2026-01-01 12:05:00.000000',NULL,NULL);
INSERT INTO "sweeps" VALUES('0a1b2c3d-0000-4000-8000-000000000000','study','{}','{}','{"alignment":"Auto","frame":"Estimate","association":{"maxDifference":"10ms","offset":0.0},"rpe":[{"delta":1.0,"unit":"m","pairs":"All","relTolerance":0.1}],"success":{"minCoverage":0.9}}','2026-01-01 12:03:00.000000',NULL,NULL);
CREATE INDEX ix_sweeps_name ON sweeps (name);
CREATE INDEX ix_runs_name ON runs (name);
CREATE INDEX runs_of_sweep ON runs (sweep, phase);
CREATE INDEX ix_runs_algorithm ON runs (algorithm);
CREATE INDEX ix_runs_dataset ON runs (dataset);
CREATE INDEX ix_runs_content_hash ON runs (content_hash);
CREATE INDEX runs_of_sweep_uid ON runs (sweep_uid, phase);
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('runs',6);
COMMIT;
