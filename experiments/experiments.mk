# Experiments as Make sees them: every artifact is a target, and what it was made from are its
# prerequisites. A changed image, odometry file or setting rebuilds what follows from it and
# nothing else. Settings are the command-line options in experiments/settings/, one file a step;
# lines that begin with # are comments.
#
#   sample_data/SET/map/* , settings/SET/reconstruct.flags -> out/experiments/SET/map/
#   map/ , settings/SET/model.flags                        -> out/experiments/SET/scene.h5
#   scene.h5 , sample_data/SET/test/* , settings/SET/VARIANT.flags
#                                                          -> out/experiments/SET/VARIANT/seed-N.h5
#   seed-N.h5                                              -> seed-N.json, and a report of the first
#   all seed-N.json                                        -> out/experiments/table.md
#   sample_data/elevators, settings/elevators/doors.toml   -> out/experiments/view-dependence/

EXPERIMENTS := out/experiments
SETTINGS := experiments/settings
SEEDS := $(shell grep -v '^\#' $(SETTINGS)/seeds.txt)
SETS := elevators workshop
# Variant of the localization -> the odometry that it is given.
VARIANTS_elevators := odometry odometry_perturbed condensation
VARIANTS_workshop := odometry odometry_perturbed
ODOMETRY_odometry := odometry.txt
ODOMETRY_odometry_perturbed := odometry_perturbed.txt
ODOMETRY_condensation := odometry.txt

# The options in a settings file, in one line.
flags = $$(shell grep -v '^\#' $(1) | tr '\n' ' ')
images = $(sort $(wildcard $(DATA)/$(1)/$(2)/rgb/*)) $(DATA)/$(1)/$(2)/rgb.txt $(DATA)/$(1)/$(2)/camera.toml

EVALUATIONS :=
REPORTS :=

# $(1): set
define map_rules
$(EXPERIMENTS)/$(1)/map/reconstruction.json: $(call images,$(1),map) $(DATA)/$(1)/map/odometry.txt \
		$(SETTINGS)/$(1)/reconstruct.flags | $(STAMP)
	$$(LFNAV) reconstruct $(DATA)/$(1)/map -o $$(@D) $(call flags,$(SETTINGS)/$(1)/reconstruct.flags) --overwrite

$(EXPERIMENTS)/$(1)/scene.h5: $(EXPERIMENTS)/$(1)/map/reconstruction.json $(SETTINGS)/$(1)/model.flags | $(STAMP)
	$$(LFNAV) model $$(<D) -o $$@ $(call flags,$(SETTINGS)/$(1)/model.flags) --overwrite
endef

# $(1): set, $(2): variant, $(3): odometry file
define run_rules
$(EXPERIMENTS)/$(1)/$(2)/seed-%.h5: $(EXPERIMENTS)/$(1)/scene.h5 $(call images,$(1),test) $(3) \
		$(DATA)/$(1)/test/groundtruth.txt $(SETTINGS)/$(1)/$(2).flags | $(STAMP)
	$$(LFNAV) localize $$< $(DATA)/$(1)/test -o $$@ --odometry $(3) --seed $$* \
		$(call flags,$(SETTINGS)/$(1)/$(2).flags) --overwrite

EVALUATIONS += $(SEEDS:%=$(EXPERIMENTS)/$(1)/$(2)/seed-%.json)
REPORTS += $(EXPERIMENTS)/$(1)/$(2)/report/report.html

$(EXPERIMENTS)/$(1)/$(2)/report/report.html: $(EXPERIMENTS)/$(1)/$(2)/seed-$(firstword $(SEEDS)).h5 | $(STAMP)
	$$(LFNAV) report $$< -o $$(@D) --overwrite
endef

$(foreach set,$(SETS),$(eval $(call map_rules,$(set))))
$(foreach set,$(SETS),$(foreach variant,$(VARIANTS_$(set)),$(eval $(call \
	run_rules,$(set),$(variant),$(DATA)/$(set)/test/$(ODOMETRY_$(variant))))))

# Renamed when complete: a half-written file would pass for a result.
%.json: %.h5 | $(STAMP)
	$(LFNAV) evaluate $< --json > $@.part
	mv $@.part $@

$(EXPERIMENTS)/table.md: $(EVALUATIONS) $(SETTINGS)/seeds.txt experiments/summarize.py | $(STAMP)
	$(VENV_PYTHON) experiments/summarize.py $(EVALUATIONS) > $@.part
	mv $@.part $@

# What view-dependent appearance is worth on the doors: a light field with depth at true poses.
APPEARANCE := $(EXPERIMENTS)/view-dependence
VIEW_DEPENDENCE := $(VENV_PYTHON) experiments/view_dependence.py
STUDIES := $(APPEARANCE)/study/table.md

$(APPEARANCE)/map/reconstruction.json: $(call images,elevators,map) $(DATA)/elevators/map/groundtruth.txt | $(STAMP)
	$(LFNAV) reconstruct $(DATA)/elevators/map -o $(@D) --method poses \
		--poses $(DATA)/elevators/map/groundtruth.txt --overwrite

$(APPEARANCE)/scene.h5: $(APPEARANCE)/map/reconstruction.json | $(STAMP)
	$(LFNAV) model $(<D) -o $@ --geometry depth --overwrite

$(APPEARANCE)/study/table.md: $(APPEARANCE)/scene.h5 $(SETTINGS)/elevators/doors.toml \
		$(call images,elevators,test) $(DATA)/elevators/test/groundtruth.txt \
		experiments/view_dependence.py | $(STAMP)
	$(VIEW_DEPENDENCE) $< $(SETTINGS)/elevators/doors.toml $(DATA)/elevators/test -o $(@D)

# Runs and scenes are results, not stepping stones that may be deleted.
.SECONDARY:

.PHONY: experiments
experiments: $(EXPERIMENTS)/table.md $(REPORTS) $(STUDIES)
	@cat $(EXPERIMENTS)/table.md $(STUDIES)
	@echo "== Table: $(EXPERIMENTS)/table.md. Reports of seed $(firstword $(SEEDS)):"
	@printf '==   %s\n' $(REPORTS)
