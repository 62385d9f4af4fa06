# Experiments: scenes, then sweeps over them, single runs with their reports, and studies.
#
# Scenes, runs and reports are targets whose prerequisites are what they were made from. Sweeps keep
# their runs themselves, under hashes of everything that went into them: they are always asked, and
# make what is missing. Options of reconstruct and model stand in experiments/settings/SET/STEP.flags,
# where lines that begin with # are comments.
#
#   sample_data/SET/map/* , settings/SET/*.flags          -> out/experiments/SET/scene.h5
#   the same and SET/map/groundtruth.txt                  -> out/experiments/true-maps/SET/scene.h5
#   sample_data/elevators/test                            -> out/experiments/disturbed/
#   scenes, sample_data/SET/test/*, sweeps/SWEEP.toml     -> out/experiments/SWEEP/table.md
#   scene of elevators, its test drive                    -> out/experiments/RUN/report/report.html
#   sample_data/elevators, settings/elevators/doors.toml  -> out/experiments/view-dependence/
#
# On demand, not by 'make experiments':
#
#   sample_data/elevators/test                            -> out/experiments/troubles/
#   scenes, drives, conditions/trust.toml                 -> out/experiments/trust/table.md
#   scene of elevators, DAYS=FOLDER, conditions/days.toml -> out/experiments/days/table.md
#   sample_data/SET/map, DAYS/hololens/map                -> out/experiments/depth-maps/SET/scene.h5
#   all scenes, DAYS=FOLDER, conditions/channels.toml     -> out/experiments/channels/table.md

EXPERIMENTS := out/experiments
SETTINGS := experiments/settings
TRUE_MAPS := $(EXPERIMENTS)/true-maps
SETS := elevators workshop
SWEEPS := every-start strategies robustness true-poses proposals particles pixels
# make experiments SEEDS=0-99: other seeds than those in sweeps/*.toml.
SEEDS :=

# The options in a settings file, in one line.
flags = $$(shell grep -v '^\#' $(1) | tr '\n' ' ')
images = $(sort $(wildcard $(DATA)/$(1)/$(2)/rgb/*)) $(DATA)/$(1)/$(2)/rgb.txt $(DATA)/$(1)/$(2)/camera.toml

# $(1): set
define map_rules
$(EXPERIMENTS)/$(1)/map/reconstruction.json: $(call images,$(1),map) $(DATA)/$(1)/map/odometry.txt \
		$(SETTINGS)/$(1)/reconstruct.flags | $(STAMP)
	$$(LFNAV) reconstruct $(DATA)/$(1)/map -o $$(@D) $(call flags,$(SETTINGS)/$(1)/reconstruct.flags) --overwrite

$(EXPERIMENTS)/$(1)/scene.h5: $(EXPERIMENTS)/$(1)/map/reconstruction.json $(SETTINGS)/$(1)/model.flags | $(STAMP)
	$$(LFNAV) model $$(<D) -o $$@ $(call flags,$(SETTINGS)/$(1)/model.flags) --overwrite

# A light field with depth at true poses: what is left of the errors when those of the map are gone.
$(TRUE_MAPS)/$(1)/map/reconstruction.json: $(call images,$(1),map) $(DATA)/$(1)/map/groundtruth.txt | $(STAMP)
	$$(LFNAV) reconstruct $(DATA)/$(1)/map -o $$(@D) --method poses \
		--poses $(DATA)/$(1)/map/groundtruth.txt --overwrite

$(TRUE_MAPS)/$(1)/scene.h5: $(TRUE_MAPS)/$(1)/map/reconstruction.json | $(STAMP)
	$$(LFNAV) model $$(<D) -o $$@ --geometry depth --overwrite
endef
$(foreach set,$(SETS),$(eval $(call map_rules,$(set))))

# Drives on which something goes wrong.
DISTURBED := $(EXPERIMENTS)/disturbed/disturbed.json
ROBUSTNESS := $(VENV_PYTHON) experiments/robustness.py

$(DISTURBED): $(call images,elevators,test) $(wildcard $(DATA)/elevators/test/odometry*.txt) \
		$(DATA)/elevators/test/groundtruth.txt experiments/robustness.py | $(STAMP)
	$(ROBUSTNESS) $(DATA)/elevators/test -o $(@D)

TABLES := $(SWEEPS:%=$(EXPERIMENTS)/%/table.md)
$(TABLES): $(EXPERIMENTS)/%/table.md: experiments/sweeps/%.toml $(SETS:%=$(EXPERIMENTS)/%/scene.h5) FORCE | $(STAMP)
	$(LFNAV) sweep $< -o $(@D) $(if $(SEEDS),--seeds $(SEEDS))

$(EXPERIMENTS)/every-start/table.md $(EXPERIMENTS)/robustness/table.md: $(DISTURBED)
$(EXPERIMENTS)/true-poses/table.md: $(SETS:%=$(TRUE_MAPS)/%/scene.h5)

# Figures 6 and 7 of the paper: the particles after the first, the middle and the last step.
RUNS := figure-6 figure-7
ODOMETRY_figure-6 := odometry.txt
ODOMETRY_figure-7 := odometry_perturbed.txt
REPORTS := $(RUNS:%=$(EXPERIMENTS)/%/report/report.html)

# $(1): run
define run_rules
$(EXPERIMENTS)/$(1)/run.h5: $(EXPERIMENTS)/elevators/scene.h5 $(call images,elevators,test) \
		$(DATA)/elevators/test/$(ODOMETRY_$(1)) $(DATA)/elevators/test/groundtruth.txt \
		$(SETTINGS)/elevators/figures.flags | $(STAMP)
	$$(LFNAV) localize $$< $(DATA)/elevators/test -o $$@ --odometry $(DATA)/elevators/test/$(ODOMETRY_$(1)) \
		$(call flags,$(SETTINGS)/elevators/figures.flags) --overwrite

$(EXPERIMENTS)/$(1)/report/report.html: $(EXPERIMENTS)/$(1)/run.h5 | $(STAMP)
	$$(LFNAV) report $$< -o $$(@D) --overwrite
endef
$(foreach run,$(RUNS),$(eval $(call run_rules,$(run))))

# What view-dependent appearance is worth on the doors.
APPEARANCE := $(EXPERIMENTS)/view-dependence
VIEW_DEPENDENCE := $(VENV_PYTHON) experiments/view_dependence.py
STUDIES := $(APPEARANCE)/study/table.md

$(APPEARANCE)/study/table.md: $(TRUE_MAPS)/elevators/scene.h5 $(SETTINGS)/elevators/doors.toml \
		$(call images,elevators,test) $(DATA)/elevators/test/groundtruth.txt \
		experiments/view_dependence.py | $(STAMP)
	$(VIEW_DEPENDENCE) $< $(SETTINGS)/elevators/doors.toml $(DATA)/elevators/test -o $(@D)

# Whether status and confidence can be trusted: in the map, in trouble, in another place.
TROUBLES := $(EXPERIMENTS)/troubles/troubles.json
TROUBLE := $(VENV_PYTHON) experiments/troubles.py
TRUST := $(VENV_PYTHON) experiments/trust.py
TRUST_WORKERS := 2
# make out/experiments/days/table.md DAYS=FOLDER: where the drives of other days are.
DAYS :=
trust = $(TRUST) $< -o $(@D) --workers $(TRUST_WORKERS) $(if $(SEEDS),--seeds $(SEEDS))

$(TROUBLES): $(call images,elevators,test) $(wildcard $(DATA)/elevators/test/odometry*.txt) \
		$(DATA)/elevators/test/groundtruth.txt experiments/troubles.py | $(STAMP)
	$(TROUBLE) $(DATA)/elevators/test -o $(@D)

$(EXPERIMENTS)/trust/table.md: experiments/conditions/trust.toml $(SETS:%=$(EXPERIMENTS)/%/scene.h5) \
		$(DISTURBED) $(TROUBLES) $(foreach set,$(SETS),$(call images,$(set),test)) FORCE | $(STAMP)
	$(trust)

$(EXPERIMENTS)/days/table.md: experiments/conditions/days.toml $(EXPERIMENTS)/elevators/scene.h5 FORCE | $(STAMP)
	$(trust) $(if $(DAYS),--data $(DAYS))

# What of the images is best compared: also in maps with depth at poses by structure from motion.
DEPTH_MAPS := $(EXPERIMENTS)/depth-maps
HOLOLENS := $(if $(DAYS),$(wildcard $(DAYS)/hololens/map/groundtruth.txt))
CHANNEL_MAPS := $(SETS:%=$(EXPERIMENTS)/%/scene.h5) $(SETS:%=$(DEPTH_MAPS)/%/scene.h5) \
	$(if $(HOLOLENS),$(DEPTH_MAPS)/hololens/scene.h5)

$(DEPTH_MAPS)/elevators/map/reconstruction.json: $(call images,elevators,map) \
		$(DATA)/elevators/map/odometry.txt | $(STAMP)
	$(LFNAV) reconstruct $(DATA)/elevators/map -o $(@D) --method sfm --planar --overwrite

$(DEPTH_MAPS)/hololens/map/reconstruction.json: $(HOLOLENS) | $(STAMP)
	$(LFNAV) reconstruct $(DAYS)/hololens/map -o $(@D) --method poses --poses $< --overwrite

$(DEPTH_MAPS)/elevators/scene.h5: $(DEPTH_MAPS)/elevators/map/reconstruction.json
$(DEPTH_MAPS)/workshop/scene.h5: $(EXPERIMENTS)/workshop/map/reconstruction.json
$(DEPTH_MAPS)/hololens/scene.h5: $(DEPTH_MAPS)/hololens/map/reconstruction.json
$(DEPTH_MAPS)/hololens/scene.h5: DEPTH := --depth given
$(SETS:%=$(DEPTH_MAPS)/%/scene.h5) $(DEPTH_MAPS)/hololens/scene.h5: | $(STAMP)
	$(LFNAV) model $(<D) -o $@ --geometry depth $(DEPTH) --overwrite

$(EXPERIMENTS)/channels/table.md: experiments/conditions/channels.toml $(CHANNEL_MAPS) \
		$(TROUBLES) $(foreach set,$(SETS),$(call images,$(set),test)) FORCE | $(STAMP)
	$(trust) $(if $(DAYS),--data $(DAYS))

# Runs and scenes are results, not stepping stones that may be deleted.
.SECONDARY:

.PHONY: experiments experiment-figures FORCE
FORCE:

experiments: $(TABLES) $(REPORTS) $(STUDIES)
	@for table in $(TABLES) $(STUDIES); do echo "== $$table"; cat $$table; done
	@echo "== Reports of single runs:"
	@printf '==   %s\n' $(REPORTS)

# The pictures of docs/experiments.md, from the results that lie there.
experiment-figures:
	for run in $(RUNS); do $(VENV_PYTHON) -c "import sys; from PIL import Image; \
		Image.open(sys.argv[1]).convert('RGB').save(sys.argv[2], quality=60)" \
		$(EXPERIMENTS)/$$run/report/figures/overview.png docs/images/$$run.jpg; done
	for plot in strategies-success strategies-convergence particles-success particles-position-error; do \
		cp $(EXPERIMENTS)/$${plot%%-*}/$${plot#*-}.png docs/images/$$plot.png; done
