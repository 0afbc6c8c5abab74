"""The paper as a workflow: phantom, tracking, background, five tests, Table 1, figures."""

from snakemake.utils import min_version

min_version("9.0")


configfile: "config/config.yaml"


report: "workflow/report/workflow.rst"


include: "workflow/rules/common.smk"
include: "workflow/rules/phantom.smk"
include: "workflow/rules/flow.smk"
include: "workflow/rules/table.smk"
include: "workflow/rules/figures.smk"
include: "workflow/rules/accuracy.smk"
include: "workflow/rules/samples.smk"
include: "workflow/rules/tiles.smk"
include: "workflow/rules/virtual_oct.smk"
include: "workflow/rules/ensemble.smk"
include: "workflow/rules/robustness.smk"
include: "workflow/rules/volume.smk"
include: "workflow/rules/benchmark.smk"
include: "workflow/rules/benchmark_volume.smk"
include: "workflow/rules/studies.smk"
include: "workflow/rules/docs.smk"


rule all:
    default_target: True
    input:
        rules.table1.output,
        rules.figures.output,
