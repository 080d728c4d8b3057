module slamhive.io/test/pause

go 1.21
