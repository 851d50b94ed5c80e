from setuptools import find_packages, setup

NAME = 'humanopts_learner'

setup(
    name=NAME,
    version='0.1.0',
    install_requires=[
        'lazy-loader>=0.3',
        'numpy>=1.26.4',
        'pandas>=2.1.4',
        'scikit-learn>=1.4.1',
        'scipy>=1.11.4',
    ],
    packages=find_packages(exclude=['test']),
    package_data={NAME: ['py.typed', '__init__.pyi']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
    ],
    extras_require={'numba': ['numba']},  # faster planning with many states
    entry_points={
        'console_scripts': [
            'learner = humanopts_learner.ros.learner_node:main',
            'option_server = humanopts_learner.ros.option_server:main',
            'planner = humanopts_learner.ros.planner_node:main',
        ],
    },
)
